"""The camera itself: its lens, its intrinsics from a file or from views, and whether the views were enough."""
