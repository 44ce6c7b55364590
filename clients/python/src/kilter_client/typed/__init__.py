"""Types of the answers of the server; all modules but this one are made from the interface by `make contract`."""
