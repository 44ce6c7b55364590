"""The palette: robots, their views, versions, campaigns and jobs by a few letters."""
