"""Choosing poses: ISO 9283's cube and diagonal planes, D-optimal poses, poses for cameras and for inclinometers."""
