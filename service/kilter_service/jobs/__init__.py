"""Long work: its queue in the database, the worker, the kinds of job, jobs of a fleet."""
