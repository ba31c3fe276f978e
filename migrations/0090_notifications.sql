-- Alarm events for a webhook. With a webhook the daemon sets webhook.is_on at its start: then every message of the outbox
-- is a notification too, in the same transaction. A notification is deleted when the receiver has accepted it.
CREATE TABLE notification (
    notification_row INTEGER PRIMARY KEY AUTOINCREMENT,
    payload          TEXT NOT NULL              -- the message as published, JSON
) STRICT;

-- One row: whether the daemon that started last has a webhook.
CREATE TABLE webhook (
    only_row INTEGER PRIMARY KEY CHECK (only_row = 1),
    is_on    INTEGER NOT NULL
) STRICT;

INSERT INTO webhook (only_row, is_on) VALUES (1, 0);

-- Of a receiver that is away for months the newest 10,000 notifications are kept; dropped ones are counted.
CREATE TRIGGER notification_added AFTER INSERT ON outbox WHEN (SELECT is_on FROM webhook) BEGIN
    INSERT INTO notification (payload) VALUES (CAST(NEW.payload AS TEXT));
    INSERT INTO counter (name, value)
        SELECT 'dropped_notifications', count(*) FROM notification
         WHERE notification_row <= (SELECT max(notification_row) FROM notification) - 10000 HAVING count(*) > 0
        ON CONFLICT (name) DO UPDATE SET value = value + excluded.value;
    DELETE FROM notification WHERE notification_row <= (SELECT max(notification_row) FROM notification) - 10000;
END;
