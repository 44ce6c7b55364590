"""The printable report of a version or a job: what an integrator hands to a customer."""
