//! The query for a page of a logger's backlog (`…/throw?after_boot=B;after_no=N;limit=K`), and the throw at which the
//! page starts.

use percent_encoding::percent_decode_str;

use crate::throw::ThrowRef;

/// Largest page \[throws\]; a higher `limit` is reduced to it.
pub const MAX_PAGE: usize = 1_000;

/// A query for one page of a backlog.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BacklogQuery {
    /// The page starts after this throw; `None` for the oldest throw of the backlog.
    pub after: Option<ThrowRef>,
    /// Largest number of throws in the page.
    pub limit: usize,
}

impl BacklogQuery {
    /// The parameters of the selector, the part after `?`.
    pub fn parameters(&self) -> String {
        match &self.after {
            Some(after) => {
                format!("after_boot={};after_no={};limit={}", escape(&after.boot_id), after.throw_no, self.limit)
            }
            None => format!("limit={}", self.limit),
        }
    }

    /// Parses the parameters of a selector. An invalid parameter counts as missing, so that a logger answers with its
    /// oldest throws instead of an error.
    pub fn parse(parameters: &str) -> Self {
        let value = |name: &str| {
            parameters.split(';').filter_map(|pair| pair.split_once('=')).find(|(key, _)| key.trim() == name)
        };
        let number = |name: &str| value(name).and_then(|(_, number)| number.trim().parse::<u64>().ok());
        let after = value("after_boot").zip(number("after_no")).map(|((_, boot_id), throw_no)| ThrowRef {
            boot_id: percent_decode_str(boot_id).decode_utf8_lossy().into_owned(),
            throw_no,
        });
        let limit = number("limit").and_then(|limit| usize::try_from(limit).ok()).unwrap_or(MAX_PAGE);
        Self { after, limit: limit.clamp(1, MAX_PAGE) }
    }

    /// Index in `kept` (the backlog, oldest first) where the page starts. It is behind the last throw of the boot of
    /// `after` whose number is not above the number of `after`. If the backlog has only later throws of this boot, it
    /// is their first one. It is 0 if the boot is unknown, or without `after`.
    pub fn start<'a>(&self, kept: impl DoubleEndedIterator<Item = &'a ThrowRef> + ExactSizeIterator) -> usize {
        let Some(after) = &self.after else { return 0 };
        let mut last_of_boot = None;
        for (at, throw) in kept.enumerate().rev() {
            if throw.boot_id == after.boot_id {
                if throw.throw_no <= after.throw_no {
                    return at + 1;
                }
                last_of_boot = Some(at);
            } else if last_of_boot.is_some() {
                break;
            }
        }
        last_of_boot.unwrap_or(0)
    }
}

/// Percent-encodes the separator of parameters, and `%`: zenoh has no escape sequence of its own. All other characters
/// are sent as they are, as a logger may compare the value with its own boot without decoding it: `=` is in every second
/// base64 text, and zenoh takes only the first one of a parameter for its separator. A `boot_id` has no control
/// characters.
fn escape(boot_id: &str) -> String {
    boot_id.replace('%', "%25").replace(';', "%3B")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn throw(boot_id: &str, throw_no: u64) -> ThrowRef {
        ThrowRef { boot_id: boot_id.to_owned(), throw_no }
    }

    #[test]
    fn parameters_read_back_as_the_query_whatever_the_boot_id() {
        for boot_id in ["7f3a", " a ", "2026-05-04T10:00:00Z/1", "a;b=c%d?e#f&g|h", "", "ü%41"] {
            let query = BacklogQuery { after: Some(throw(boot_id, 41)), limit: 32 };
            let parameters = query.parameters();
            assert_eq!(BacklogQuery::parse(&parameters), query, "{parameters}");
        }
        let plain = BacklogQuery { after: Some(throw("q83/+Eg==", 41)), limit: 32 };
        assert_eq!(plain.parameters(), "after_boot=q83/+Eg==;after_no=41;limit=32", "for loggers that do not decode");
        let oldest = BacklogQuery { after: None, limit: 4 };
        assert_eq!(oldest.parameters(), "limit=4");
        assert_eq!(BacklogQuery::parse("limit=4"), oldest);
        assert_eq!(BacklogQuery::parse("after_boot=b;limit=x"), BacklogQuery { after: None, limit: MAX_PAGE });
        assert_eq!(BacklogQuery::parse("limit=0;_time=[now()]").limit, 1);
    }

    #[test]
    fn a_page_starts_after_the_cursor_and_at_the_oldest_for_an_unknown_boot() {
        let kept = [throw("a", 8), throw("a", 9), throw("b", 1), throw("b", 2), throw("b", 4)];
        let start = |after: Option<ThrowRef>| BacklogQuery { after, limit: 9 }.start(kept.iter());
        assert_eq!(start(None), 0);
        assert_eq!(start(Some(throw("x", 3))), 0);
        assert_eq!(start(Some(throw("a", 3))), 0);
        assert_eq!(start(Some(throw("a", 8))), 1);
        assert_eq!(start(Some(throw("a", 9))), 2);
        assert_eq!(start(Some(throw("a", 12))), 2);
        assert_eq!(start(Some(throw("b", 0))), 2);
        assert_eq!(start(Some(throw("b", 3))), 4);
        assert_eq!(start(Some(throw("b", 4))), 5);
    }
}
