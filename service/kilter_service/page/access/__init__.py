"""Who may do what: tokens, their roles, robots and ends."""
