"""What can be asked of a server, as documents: one function for each route, which says its steps and sends nothing."""
