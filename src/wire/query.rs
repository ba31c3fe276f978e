//! The parameters of `health` and `alarm` queries: `?since=2026-05-04T00:00:00Z;limit=100`.

use jiff::Timestamp;

use super::Invalid;

/// Largest number of rows in the reply to a query.
pub const MAX_HISTORY: u32 = 10_000;
/// Rows in the reply to a history query without `limit`.
const DEFAULT_LIMIT: u32 = 1_000;

/// The parameters of a `health` or `alarm` query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HistoryQuery {
    /// No parameters: the open alarms, or the latest health of each machine.
    Current,
    /// The newest `limit` rows since `since`, oldest first.
    History {
        /// Time of the oldest row; 1970 for no bound.
        since: Timestamp,
        /// Largest number of rows.
        limit: u32,
    },
}

impl HistoryQuery {
    /// Parses the parameters of a selector (the part after `?`). Unknown parameters are ignored.
    ///
    /// # Errors
    /// When `since` or `limit` is invalid.
    pub fn parse(parameters: &str) -> Result<Self, Invalid> {
        let pairs = || parameters.split(';').filter_map(|pair| pair.split_once('='));
        let value = |name: &str| pairs().find(|(key, _)| key.trim() == name).map(|(_, value)| value.trim());
        let wrong = |name: &str, text: &str, must: &str| {
            let text: String = text.chars().take(60).collect();
            Invalid(format!("{name}={text:?} {must}"))
        };
        // URL encoders write `+` as a space, so both are accepted in the offset.
        let since = value("since").map(|text| {
            let must = "is not an RFC 3339 time with Z or an offset, as 2026-05-04T10:11:12Z";
            text.replace(' ', "+").parse().map_err(|_| wrong("since", text, must))
        });
        let limit = value("limit").map(|text| match text.parse() {
            Ok(limit @ 1..=MAX_HISTORY) => Ok(limit),
            _ => Err(wrong("limit", text, &format!("must be a whole number from 1 to {MAX_HISTORY}"))),
        });
        let (since, limit) = (since.transpose()?, limit.transpose()?);
        Ok(match (since, limit) {
            (None, None) => Self::Current,
            (since, limit) => {
                Self::History { since: since.unwrap_or(Timestamp::UNIX_EPOCH), limit: limit.unwrap_or(DEFAULT_LIMIT) }
            }
        })
    }
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
            assert_eq!(HistoryQuery::parse(text).unwrap(), HistoryQuery::History { since: noon, limit: 7 });
        }
        for text in ["since=yesterday", "limit=0", "limit=-1", "limit=10001", "limit=many"] {
            assert!(HistoryQuery::parse(text).is_err(), "{text} was taken");
        }
    }
}
