"""What a search reports: where the error is, the report, figures, what to measure next, what is stored."""
