"""Pixels -> tokens: one file for each kind of backbone."""
