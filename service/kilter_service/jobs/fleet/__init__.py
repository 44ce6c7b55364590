"""Many robots identified anew by one request: a job for each, in the ordinary queue."""
