"""Column maps: which columns of a lab's file are which contract columns, and joins with a second file."""
