"""What a name rests on: rivals, intervals, held-out poses, negative control, replication, gates."""
