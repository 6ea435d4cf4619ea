"""Effects that the base model lacks, one file each; a new file is found by itself."""
