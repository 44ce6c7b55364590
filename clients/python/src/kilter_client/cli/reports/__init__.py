"""Results of jobs, versions and activations as text."""
