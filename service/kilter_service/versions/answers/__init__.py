"""Answers and rules that were kept with activations."""
