"""Blind benchmark of the gap finder: cases made from the physics, scored against what was hidden."""
