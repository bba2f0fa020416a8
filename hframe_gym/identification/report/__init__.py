"""Results of an identification: files, plots, the page, advice and the next experiment."""
