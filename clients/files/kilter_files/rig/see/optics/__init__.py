"""The camera: its intrinsics from files, from views, and what its lens does."""
