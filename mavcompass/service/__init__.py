"""The companion-computer service: keeps the link, watches the compass, serves people and programs."""
