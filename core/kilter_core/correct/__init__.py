"""From a version to corrected setpoints: program, trajectory walker, limits, reference."""
