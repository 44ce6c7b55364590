"""Figures as SVG, for the page and for the printed report: presentation attributes only, a table beside each."""
