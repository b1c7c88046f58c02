"""Page of a study: tables, figures and maps."""
