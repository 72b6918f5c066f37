"""The paper's tables: every row trained on equal terms, measured, and written side by side."""
