"""What data can tell: rank, sums that are known, observability of poses, models of loads."""
