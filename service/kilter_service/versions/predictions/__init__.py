"""What a version predicts: residuals, own errors, corrections at poses and in the workspace, and how two differ."""
