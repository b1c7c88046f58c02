"""One file per job: a recording or images in, a result out. A command in `workbench.commands` parses
the call, runs the job and writes its run folder."""
