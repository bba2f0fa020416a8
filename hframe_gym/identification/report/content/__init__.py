"""The result of an identification: collected, converted to report.json, written and read."""
