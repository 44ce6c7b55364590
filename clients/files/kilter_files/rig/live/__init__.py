"""Boards in the picture of a camera that is running: what is seen, what is still missing, and views when the arm rests."""
