"""Layout of diagnosis.json (docs/reference/diagnosis_json.md): its version, and parts shared by several modules."""

SCHEMA = 2
NO_LIMITS = dict.fromkeys(("kind", "session", "from_s", "to_s", "regime"))
"""Keys of a support, with null for those that do not apply."""
