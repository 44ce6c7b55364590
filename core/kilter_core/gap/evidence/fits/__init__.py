"""The final fit of a search, fitted again and widened, and the intervals of its amounts."""
