"""Hardware that speaks its real bytes and is not there: sensor boards and drives."""
