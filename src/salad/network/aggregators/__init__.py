"""Tokens -> descriptor: one file for each way to do it."""
