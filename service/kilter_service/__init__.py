"""The Kilter service: HTTP, database, jobs and processes around the core."""
