//! A turn of a logger: queries for several pages of its backlog in a row. Each page is stored before the next one is
//! queried.

use std::time::Duration;

use tokio::time::Instant;

use super::{Intake, Origin};
use crate::{
    bus,
    daemon::{clock, shared::Shared},
    store::{Cursor, StoreError, seldom},
    throw::{MachineId, Throw, ThrowRef},
    wire::{self, BacklogQuery, Kind},
};

/// Time after which a turn ends and counts as slow: a page of 1 MiB on a link with 500 kB/s.
pub(super) const LONG_TURN: Duration = Duration::from_secs(2);
/// Throws in the first page, while the size of the throws and the speed of the link are unknown.
const FIRST_PAGE: usize = 4;
/// Throws in the largest page.
const LARGEST_PAGE: usize = 32;
/// Target size of a page \[bytes\]: a link with 70 kB/s delivers it before the timeout.
const PAGE_BYTES: u64 = 1 << 20;
/// Size of a sample \[bytes\]: current and position as float32.
const SAMPLE_BYTES: u64 = 8;
/// Largest number of pages of one logger in a turn.
const TURN: usize = 8;
/// The turn ends after this many pages without a new throw. Such pages come from a logger that does not know the boot of
/// the cursor, as after an import of recordings, and begins with its oldest throw. While throws are missing, a page that
/// comes later than the one before does not count, so the whole backlog is read. While none is missing, the turn ends
/// here: otherwise the whole backlog would be sent again in each round. A newer throw behind these pages is found with
/// the next live throw.
const REPEATED_PAGES: usize = 4;
/// After a page without a usable throw, the next query begins at the same throw and asks for this many times more
/// throws. The size grows from one throw to [`wire::MAX_PAGE`] within a turn.
const WIDER: usize = 4;

/// How a turn of a logger ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum QueryEnd {
    /// The logger has no newer throw, and none is missing.
    Complete,
    /// The turn was long enough; the logger may have more throws.
    More,
    /// The logger replied without the throws that are missing after this cursor.
    Without(Cursor),
    /// The logger did not reply in time, or its replies could not be stored.
    Broken,
}

/// The query with which the next turn of a logger begins.
pub(super) struct NextPage {
    /// Largest number of throws.
    size: usize,
    /// The position after the last stored page; `None` to begin at the cursor of the database.
    after: Option<Cursor>,
    /// Whether throws of the machine were missing when its logger was queried from the cursor of the database.
    awaits: bool,
    /// Number of pages without a new throw, since the last page with one.
    repeated: usize,
    /// Whether the next throw is larger than a page. Its turn has the only place for such throws.
    pub(super) is_large: bool,
}

impl Default for NextPage {
    fn default() -> Self {
        Self { size: FIRST_PAGE, after: None, awaits: false, repeated: 0, is_large: false }
    }
}

/// The reply of a logger to the query for a page.
struct ThrowPage {
    /// The usable throws, oldest first.
    throws: Vec<Throw>,
    /// Whether the query ended without an error.
    is_complete: bool,
    /// Whether the logger sent no message at all.
    is_empty: bool,
    /// Whether the first throw was dropped because it is larger than a page.
    is_too_large: bool,
}

impl Intake {
    /// Queries a logger page by page, at most [`TURN`] pages, and updates its next page. Returns how the turn ended.
    pub(super) async fn query(&self, machine: &MachineId, next: &mut NextPage) -> QueryEnd {
        self.pages(machine, next).await.unwrap_or_else(|error| {
            seldom!(warn, %machine, %error, "storing a page of a backlog failed; retrying");
            QueryEnd::Broken
        })
    }

    async fn pages(&self, machine: &MachineId, next: &mut NextPage) -> Result<QueryEnd, StoreError> {
        // A client without its router gets an empty page, as from a logger without throws.
        if self.shared.is_client && !bus::is_connected(&self.shared.session).await {
            return Ok(QueryEnd::Broken);
        }
        let mut cursor = if let Some(after) = next.after.clone() {
            after
        } else {
            let cursor = self.shared.store.reader().cursor(machine).await?;
            next.awaits = cursor.awaits;
            cursor
        };
        let (mut least, start, mut is_large) = (1, Instant::now(), next.is_large);
        for _ in 0..TURN {
            // A large throw fills a page.
            let limit = if is_large { 1 } else { page_limit(&cursor, next.size).max(least) };
            let page = self.page(machine, &cursor, limit, is_large).await?;
            let ThrowPage { throws, is_complete, is_empty, is_too_large } = page;
            if is_too_large {
                next.is_large = true;
                return Ok(QueryEnd::More);
            }
            let Some((new, after)) = self.store_page(machine, cursor.after.as_ref(), &throws).await? else {
                // The message after a large throw.
                if is_complete && is_large && !next.is_large {
                    is_large = false;
                    continue;
                }
                // Throws may follow after messages that are invalid, that the database refuses, or that zenoh drops
                // because of their size. None can follow in the page of a large message.
                if is_complete && !is_large && (cursor.awaits || !is_empty) && limit < wire::MAX_PAGE {
                    least = (WIDER * limit).min(wire::MAX_PAGE);
                    continue;
                }
                return Ok(match is_complete {
                    false => {
                        next.size = (next.size / 2).max(1);
                        QueryEnd::Broken
                    }
                    true if cursor.awaits => QueryEnd::Without(cursor),
                    true => QueryEnd::Complete,
                });
            };
            self.shared.stored.notify_one();
            let is_later = next.awaits && after.is_after(&cursor);
            cursor = after;
            next.after = Some(cursor.clone());
            next.repeated = if new > 0 { 0 } else { next.repeated + usize::from(!is_later) };
            (least, next.is_large) = (1, false);
            if !is_complete {
                next.size = (next.size / 2).max(1);
                return Ok(QueryEnd::Broken);
            }
            if next.repeated >= REPEATED_PAGES && !is_later {
                return Ok(if next.awaits { QueryEnd::Without(cursor) } else { QueryEnd::Complete });
            }
            next.size = (next.size * 2).min(LARGEST_PAGE);
            if start.elapsed() >= LONG_TURN {
                break;
            }
        }
        Ok(QueryEnd::More)
    }

    /// Stores the throws of a page; returns the number of new ones and the next cursor, or `None` if none was stored. If
    /// SQLite refuses the page (constraint, type), it is halved down to the throws that SQLite refuses alone. These go
    /// to quarantine, and the next stored throw makes their numbers a gap. A retry would fail for ever.
    async fn store_page(
        &self,
        machine: &MachineId,
        mut after: Option<&ThrowRef>,
        throws: &[Throw],
    ) -> Result<Option<(u64, Cursor)>, StoreError> {
        let (at, mut new, mut next) = (clock::now(), 0, None);
        let mut parts = if throws.is_empty() { Vec::new() } else { vec![throws] };
        while let Some(part) = parts.pop() {
            match self.shared.store.spool_page(machine, after, part, at).await {
                Ok(stored) => {
                    self.shared.status.edit().stored += stored.new;
                    self.shared.status.edit().duplicates += stored.duplicates;
                    new += stored.new;
                    (after, next) = (part.last().map(|throw| &throw.id), Some(stored.cursor));
                }
                Err(StoreError::Refused(problem)) => {
                    if let [throw] = part {
                        let refused = super::unstorable(machine, throw, &problem, at);
                        self.quarantine_of_backlog(vec![refused]).await?;
                    } else {
                        let (first, rest) = part.split_at(part.len() / 2);
                        parts.extend([rest, first]);
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(next.map(|cursor| (new, cursor)))
    }

    /// Queries a page of throws after the cursor, and quarantines its invalid messages.
    async fn page(
        &self,
        machine: &MachineId,
        cursor: &Cursor,
        limit: usize,
        may_be_large: bool,
    ) -> Result<ThrowPage, StoreError> {
        let query = BacklogQuery { after: cursor.after.clone(), limit };
        let Shared { session, config, .. } = &*self.shared;
        let key = wire::machine_key(machine, Kind::Throw);
        let answer = bus::page(session, &key, &query, config.subscribe.max_payload_bytes, may_be_large).await;
        if let Some(error) = &answer.error {
            seldom!(warn, %machine, ?error, "the query for the backlog of a logger failed; asking again later");
        }
        let received = answer.messages.len() as u64;
        self.shared.status.edit().received += received;
        let (read, refused) = self.read(answer.messages, Origin::Backlog).await;
        self.quarantine_of_backlog(refused).await?;
        let mut throws: Vec<_> = read.into_iter().map(|received| received.throw).collect();
        let read = throws.len();
        keep_order(&mut throws, cursor.after.as_ref());
        let ignored = answer.ignored + (read - throws.len()) as u64;
        self.shared.status.edit().ignored += ignored;
        if ignored > 0 {
            seldom!(warn, %machine, ignored, "replies of a logger do not match the query: ignored");
        }
        let (is_complete, is_too_large) = (answer.is_complete, answer.is_too_large);
        Ok(ThrowPage { throws, is_complete, is_empty: received == 0, is_too_large })
    }
}

/// Number of throws in the next page: at most `size`, at most [`PAGE_BYTES`] of samples, at most the missing throws,
/// and at least one.
fn page_limit(cursor: &Cursor, size: usize) -> usize {
    let bytes = cursor.samples.unwrap_or(0).saturating_mul(SAMPLE_BYTES).max(1);
    let fits = usize::try_from(PAGE_BYTES / bytes).unwrap_or(usize::MAX);
    let missing = cursor.missing.and_then(|missing| usize::try_from(missing).ok()).unwrap_or(usize::MAX);
    size.min(fits).min(missing).max(1)
}

/// Removes throws whose number is not above that of the throw before them in the same boot.
fn keep_order(throws: &mut Vec<Throw>, after: Option<&ThrowRef>) {
    let mut last = after.cloned();
    throws.retain(|throw| {
        let follows =
            last.as_ref().is_none_or(|last| last.boot_id != throw.id.boot_id || last.throw_no < throw.id.throw_no);
        if follows {
            last = Some(throw.id.clone());
        }
        follows
    });
}
