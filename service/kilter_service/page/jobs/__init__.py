"""Jobs: the form with its check, how far a job is, and what came out."""
