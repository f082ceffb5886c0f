"""The operating system: whole files, a writer thread, the journal, systemd notifications."""
