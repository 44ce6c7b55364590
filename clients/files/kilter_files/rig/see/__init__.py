"""What a camera sees of boards: pictures become rows of pixels."""
