"""What a file holds, before anything is sent: inspection, the draft of a map, a dry run."""
