"""People at the page log in with a token; their browser keeps another secret, which ends by itself."""
