"""Operators: thin, the work is in functions that scripts can call as well."""
