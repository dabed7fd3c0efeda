"""Links: over a wire, through MAVSDK, inside this process, with faults; and the server of a vehicle."""
