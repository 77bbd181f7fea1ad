"""Errors, input checks, compiled functions and fast calls, for this package alone."""
