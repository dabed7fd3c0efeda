"""The service's face for people and programs: the page, the HTTP interface and the WebSocket."""
