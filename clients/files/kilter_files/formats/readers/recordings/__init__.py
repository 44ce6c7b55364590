"""What the readers of recordings state: markers seen by cameras, frame by frame."""
