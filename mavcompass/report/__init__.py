"""Results for people and programs: documents in JSON, reports in self-contained HTML."""
