"""Which worker runs which job, and how a job leaves a worker that is gone."""
