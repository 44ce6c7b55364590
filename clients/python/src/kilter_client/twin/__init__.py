"""A calibrated twin beside anybody's model: laid onto MuJoCo or USD, compared with measured poses, read for its drives."""
