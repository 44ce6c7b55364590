"""Results that a change of the code's shape must not move: written by one commit, compared with those of another."""
