"""One file a vendor, found by listing this folder. `readers/_csv/vendor.py` says what each binds."""
