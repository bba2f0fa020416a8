"""The generated parts of the pages, one module per subject; `python -m tools.tables` writes all of them."""
