"""What jobs read: rows of campaigns, set-ups, sheets, poses, loads and limits of a version."""
