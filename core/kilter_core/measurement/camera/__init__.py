"""What cameras see: pixels as a kind, views, boards, the camera's model, and where cameras and boards stand."""
