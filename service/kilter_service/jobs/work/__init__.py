"""The worker: takes jobs from the queue, runs them, and says what came out."""
