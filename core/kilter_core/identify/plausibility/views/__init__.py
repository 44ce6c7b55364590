"""Whether views are of the arm, the cameras and the boards that the rows name."""
