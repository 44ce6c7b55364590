"""What rows must be before they are taken: limits of joints, sizes of payloads, corners in pictures."""
