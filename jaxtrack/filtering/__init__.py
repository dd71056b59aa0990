"""Recursive filters. `rls` smooths initialised tracks."""
