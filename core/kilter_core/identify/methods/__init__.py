"""The methods of identification, one per file."""
