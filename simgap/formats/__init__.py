"""Files: recordings and diagnoses, written whole or not at all, and read with errors that say what is wrong.

Equal content makes equal bytes, so that caches and digests hold.
"""
