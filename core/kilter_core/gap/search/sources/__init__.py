"""What a search reads: rows of poses, tool points, contacts and links as whitened residuals with their columns."""
