"""How long jobs are kept."""
