"""Campaigns that measure joint by joint: circle points, inclinometers, two encoders, a digitised frame."""
