"""The page that people look at: views of what the HTTP interface gives, drawn on the server."""
