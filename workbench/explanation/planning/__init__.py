"""The next experiment: recordings that might end a doubt (`planned`), compared (`experiment`), as scenes (`scenes`)."""
