"""From a version to corrected setpoints: program, walker, limits, reference."""
