"""What Prometheus reads: counters of this process, and what the database, the arms and the streams say."""
