"""Rendered truth: shots and boards made by brute force."""
