"""Points and poses of trackers and measuring machines."""
