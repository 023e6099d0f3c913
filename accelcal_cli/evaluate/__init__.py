"""The papers' tables against this implementation."""
