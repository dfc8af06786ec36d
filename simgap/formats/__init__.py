"""Files of recordings and diagnoses: written whole or not at all, and read with errors that say what is wrong.

Equal content gives equal bytes, so that caches and digests stay valid.
"""
