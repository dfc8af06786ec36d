"""Layout of diagnosis.json (docs/reference/diagnosis_json.md): its version, and parts that several modules fill."""

SCHEMA = 2
NO_LIMITS = dict.fromkeys(("kind", "session", "from_s", "to_s", "regime"))
"""Parts of a support, as they are where they do not apply."""
