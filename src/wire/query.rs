//! The parameters of `health` and `alarm` queries: `?since=2026-05-04T00:00:00Z;limit=100`.

use jiff::Timestamp;

/// Most rows that one query returns.
pub const MAX_HISTORY: usize = 10_000;
/// Rows of a history query that names no limit.
const DEFAULT_LIMIT: usize = 1_000;

/// What a query asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HistoryQuery {
    /// No parameters: the open alarms, or the latest health of each machine.
    Current,
    /// Everything from a moment on, the newest `limit` rows, oldest first.
    History {
        /// Not before this; `None` for as far back as there is.
        since: Option<Timestamp>,
        /// At most this many.
        limit: usize,
    },
}

/// Why a query's parameters cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidQuery {
    /// `since` is no time.
    #[error("since={text:?} is no RFC 3339 time with Z or an offset, as 2026-05-04T10:11:12Z")]
    Since {
        /// The text.
        text: String,
    },
    /// `limit` is no number in range.
    #[error("limit={text:?} must be a whole number from 1 to {MAX_HISTORY}")]
    Limit {
        /// The text.
        text: String,
    },
}

impl HistoryQuery {
    /// Reads the parameters of a selector (the part after `?`). Other parameters are ignored.
    ///
    /// # Errors
    /// When `since` or `limit` cannot be used.
    pub fn parse(parameters: &str) -> Result<Self, InvalidQuery> {
        let pairs = || parameters.split(';').filter_map(|pair| pair.split_once('='));
        let value = |name: &str| pairs().find(|(key, _)| key.trim() == name).map(|(_, value)| value.trim());
        // `+` separates nothing in a zenoh selector, yet HTTP habits turn it into a space: both are taken.
        let since = value("since")
            .map(|text| text.replace(' ', "+").parse().map_err(|_| InvalidQuery::Since { text: cut(text) }))
            .transpose()?;
        let limit = value("limit")
            .map(|text| match text.parse() {
                Ok(limit @ 1..=MAX_HISTORY) => Ok(limit),
                _ => Err(InvalidQuery::Limit { text: cut(text) }),
            })
            .transpose()?;
        Ok(match (since, limit) {
            (None, None) => Self::Current,
            (since, limit) => Self::History { since, limit: limit.unwrap_or(DEFAULT_LIMIT) },
        })
    }
}

fn cut(text: &str) -> String {
    text.chars().take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_become_a_query_or_a_reason() {
        assert_eq!(HistoryQuery::parse("").unwrap(), HistoryQuery::Current);
        assert_eq!(HistoryQuery::parse("_time=[now(-1h)..]").unwrap(), HistoryQuery::Current);
        let noon = "2026-05-04T12:00:00Z".parse().unwrap();
        for text in ["since=2026-05-04T12:00:00Z;limit=7", "limit=7;since=2026-05-04T14:00:00+02:00"] {
            assert_eq!(HistoryQuery::parse(text).unwrap(), HistoryQuery::History { since: Some(noon), limit: 7 });
        }
        for text in ["since=yesterday", "limit=0", "limit=-1", "limit=10001", "limit=many"] {
            assert!(HistoryQuery::parse(text).is_err(), "{text} was taken");
        }
    }
}
