"""The commands people type; each module holds one click command and imports the rest only when it runs."""
