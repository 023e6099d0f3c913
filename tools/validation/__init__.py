"""`make validation`: accelcal beside other methods on the same data, as one page.

`python -m tools.validation` writes build/validation.md, from which the tables of docs/compared.md are.
"""
