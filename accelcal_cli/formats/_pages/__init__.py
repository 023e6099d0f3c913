"""Shared by readers of files that are made of pages."""
