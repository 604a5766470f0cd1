"""What every part uses: long work, parallel work, compiled code, records, signals."""
