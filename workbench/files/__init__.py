"""Files that the workbench reads and writes: scenes, solutions, results, run folders, exports, target
lists, spooled samples, and the provenance of a result."""
