"""Who may change things."""
