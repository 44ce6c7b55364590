"""Parameter versions: stored, activated, compared, previewed; how good an arm is today, and since when."""
