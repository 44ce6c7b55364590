"""Loads on the joints from weight, motion, payload and an external wrench, and how they follow errors of the masses."""
