"""Pages that need no network: a study's report with its atlas, and the results of all studies."""
