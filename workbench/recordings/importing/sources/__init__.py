"""Sources of an import: tables found, joined by keys or by time, and headers that do not say enough."""
