"""Errors and border checks, compiled functions, fast calls: for the package itself."""
