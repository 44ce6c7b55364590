"""A path corrected on the page: dropped, looked at row by row, and downloaded. The route of the interface corrects it."""
