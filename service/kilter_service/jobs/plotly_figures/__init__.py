"""Figures of jobs as Plotly documents."""
