"""The steps of an identification in their order: start, fit, validation, uncertainty, findings, report."""
