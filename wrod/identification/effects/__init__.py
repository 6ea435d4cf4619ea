"""Effects that the base model lacks, a file for each kind; a new file is found by itself."""
