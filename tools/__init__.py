"""Scripts that measure the repository and generate its tables, pages and examples."""
