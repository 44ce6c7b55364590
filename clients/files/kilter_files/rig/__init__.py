"""Measuring rigs: the drawn circle, ball bars and inclinometers with the joint log, the printed sheet and boards."""
