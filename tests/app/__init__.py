"""Tests of the window `hframe app`."""
