"""What a search tells: where the error is, the report, figures, what to measure next, what is stored."""
