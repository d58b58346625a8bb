"""Identification of constants from measured force."""
