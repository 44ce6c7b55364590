"""Views of the page: a folder for each, drawn on the server; a view calls services, and no store."""
