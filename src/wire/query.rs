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
        /// Earliest time of a row; 1970 for no limit.
        since: Timestamp,
        /// Largest number of rows.
        limit: u32,
    },
}

impl HistoryQuery {
    /// Parses the parameters of a selector (the part after `?`).
    ///
    /// # Errors
    /// When `since` or `limit` is invalid, or another parameter is given.
    pub fn parse(parameters: &str) -> Result<Self, Invalid> {
        check_parameters(parameters, &["since", "limit"])?;
        let value = |name: &str| pairs(parameters).find(|(key, _)| *key == name).map(|(_, value)| value);
        let wrong = |name: &str, text: &str, must: &str| {
            let text: String = text.chars().take(60).collect();
            Invalid(format!("{name}={text:?} {must}"))
        };
        // URL decoders turn the `+` of an offset into a space, so a space is accepted too.
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

/// Names and values of the parameters; without `=` the value is empty.
fn pairs(parameters: &str) -> impl Iterator<Item = (&str, &str)> {
    let pairs = parameters.split(';').map(|pair| pair.split_once('=').unwrap_or((pair, "")));
    pairs.map(|(key, value)| (key.trim(), value.trim())).filter(|pair| *pair != ("", ""))
}

/// Checks that every parameter has a value, and is in `known` or belongs to zenoh (its name begins with `_`): ignoring
/// a misspelt parameter would change the meaning of a query without notice.
///
/// # Errors
/// When a parameter is unknown, has no value or is given twice; the error names it and the known parameters.
pub fn check_parameters(parameters: &str, known: &[&str]) -> Result<(), Invalid> {
    if let Some((empty, _)) = pairs(parameters).find(|(key, value)| known.contains(key) && value.is_empty()) {
        return Err(Invalid(format!("{empty} has no value")));
    }
    let given = |name: &str| pairs(parameters).filter(|(key, _)| *key == name).count();
    if let Some(twice) = known.iter().find(|name| given(name) > 1) {
        return Err(Invalid(format!("{twice} is given twice")));
    }
    let is_unknown = |key: &&str| !key.starts_with('_') && !known.contains(key);
    let Some(unknown) = pairs(parameters).map(|(key, _)| key).find(is_unknown) else { return Ok(()) };
    let unknown: String = unknown.chars().take(60).collect();
    let known =
        if known.is_empty() { "this query has none".to_owned() } else { format!("known are {}", known.join(", ")) };
    Err(Invalid(format!("unknown parameter {unknown:?}: {known}")))
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
        for text in [
            "since=yesterday",
            "limit=0",
            "limit=-1",
            "limit=10001",
            "limit=many",
            "since=",
            "since",
            "limit",
            "limit=2;limit=3",
        ] {
            assert!(HistoryQuery::parse(text).is_err(), "{text} was taken");
        }
        for text in ["sinc=2026-05-04T12:00:00Z", "limit=7;until=2026-05-04T12:00:00Z", "_anyke;Limit=7"] {
            let error = HistoryQuery::parse(text).unwrap_err().to_string();
            assert!(error.starts_with("unknown parameter") && error.ends_with("known are since, limit"), "{error}");
        }
        assert!(check_parameters("_time=[now(-1h)..];_anyke", &[]).is_ok());
        assert_eq!(check_parameters("session=", &["session"]).unwrap_err().to_string(), "session has no value");
        assert_eq!(
            check_parameters("limit=1", &[]).unwrap_err().to_string(),
            "unknown parameter \"limit\": this query has none"
        );
    }
}
