"""What rows say of themselves: noise, errors by kind, influence, measured tilt."""
