"""Results of an identification: simulation of recordings, files, plots, the page and the next experiment."""
