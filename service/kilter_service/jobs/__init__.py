"""Long computations, run durably in a worker process."""
