"""Commands as users call them: options, text, JSON, exit codes, pages and exports."""
