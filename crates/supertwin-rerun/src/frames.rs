//! The messages of a file one by one, and what is damaged between them.
//!
//! Rerun's own decoder ends at the first damage. Here a message that can't be read costs that message: the next one is
//! where the damaged one says that it ends, or else is looked for byte by byte.

use crate::{RECORDER_CLOCK, SENDER_CLOCK, TICK, TIME};
use re_protos::log_msg::v1alpha1::log_msg::Msg;
use rerun::external::arrow::ipc::root_as_message;
use rerun::external::re_log_encoding::external::lz4_flex;
use rerun::external::re_log_encoding::{
    CachingApplicationIdInjector, Compression, Decodable, DecoderEntrypoint, EncodingOptions, MessageHeader,
    MessageKind, RRD_FOURCC, RawRrdManifest, StreamFooter, StreamHeader, ToApplication,
};
use rerun::external::re_log_types::TimeType;
use rerun::log::{Chunk, LogMsg};
use std::cell::Cell;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

/// Bytes that are looked through at a time for the next message.
const WINDOW: u64 = 1 << 20;
const BEGIN: u64 = StreamHeader::ENCODED_SIZE_BYTES as u64;
const HEADER: u64 = MessageHeader::ENCODED_SIZE_BYTES as u64;
const FOOTER: u64 = StreamFooter::ENCODED_SIZE_BYTES as u64;
/// No list of contents is longer.
const MOST_LIST: u64 = 1 << 32;
/// LZ4 makes at most this many bytes out of one.
const LZ4_EXPANSION: u64 = 255;

/// What stands at a place in the file.
pub(crate) enum Piece {
    /// A message of the Rerun log that is not a chunk of data.
    Message(Box<LogMsg>),
    /// Part of the recording, with the store it belongs to.
    Chunk(Box<LogMsg>, Box<Chunk>),
    /// Something that can't be read, and why.
    Lost(String),
}

/// A file is no recording at all.
pub(crate) enum Foreign {
    /// There is nothing in it, or less than a beginning.
    Empty,
    /// It begins differently.
    Other(String),
    /// It can't be read.
    Io(io::Error),
}

impl From<io::Error> for Foreign {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// A file, message by message.
pub(crate) struct Frames<F> {
    file: F,
    at: u64,
    /// Bytes of the file.
    pub(crate) length: u64,
    pub(crate) header: StreamHeader,
    injector: CachingApplicationIdInjector,
}

impl<F: Read + Seek> Frames<F> {
    pub(crate) fn open(mut file: F) -> Result<Self, Foreign> {
        let length = file.seek(SeekFrom::End(0))?;
        let mut begin = [0; StreamHeader::ENCODED_SIZE_BYTES];
        if length < begin.len() as u64 {
            return Err(Foreign::Empty);
        }
        file.seek(SeekFrom::Start(0))?;
        file.read_exact(&mut begin)?;
        let header = quietly(|| {
            let header = StreamHeader::from_rrd_bytes(&begin)?;
            header.to_version_and_options().map(|_| header)
        });
        // Stands for a beginning that can't be read.
        let unreadable = StreamHeader {
            fourcc: RRD_FOURCC,
            version: rerun::build_info().version.to_bytes(),
            options: EncodingOptions::PROTOBUF_UNCOMPRESSED,
        };
        let (header, problem) = match header {
            Ok(Ok(header)) => (header, None),
            Ok(Err(error)) => (unreadable, Some(error.to_string())),
            Err(()) => (unreadable, Some("its first bytes make no sense".to_owned())),
        };
        let mut frames = Self { file, at: 0, length, header, injector: CachingApplicationIdInjector::default() };
        match problem {
            None => frames.at = BEGIN,
            // The beginning is damaged, or this is no recording: its first message tells.
            Some(problem) => match frames.header_at(BEGIN)? {
                Some(header) if frames.message(BEGIN + HEADER, header)?.is_ok() => {}
                _ => return Err(Foreign::Other(problem)),
            },
        }
        Ok(frames)
    }

    /// The next piece and the bytes it takes; `None` after the last.
    pub(crate) fn next(&mut self) -> io::Result<Option<(Range<u64>, Piece)>> {
        let at = self.at;
        if at >= self.length {
            return Ok(None);
        }
        if at == 0 {
            self.at = BEGIN;
            return Ok(Some((0..BEGIN, Piece::Lost("the beginning of the file is damaged".to_owned()))));
        }
        let (end, piece) = match self.header_at(at)? {
            Some(header) if header.kind == MessageKind::End => {
                let end = at + HEADER + header.len;
                if end == self.length || end + FOOTER == self.length {
                    self.at = self.length;
                    return Ok(None);
                }
                (self.length, Piece::Lost("bytes after the end of the recording".to_owned()))
            }
            Some(header) => {
                let end = at + HEADER + header.len;
                match self.message(at + HEADER, header)? {
                    Ok(piece) => (end, piece),
                    // Its content is damaged, or the length that it gives.
                    Err(problem) if self.plausible(end)? => (end, Piece::Lost(problem)),
                    Err(problem) => (self.search(at + 1)?, Piece::Lost(problem)),
                }
            }
            None if self.is_broken_end(at)? => {
                self.at = self.length;
                return Ok(Some((at..at, Piece::Lost("the list of contents at the end is damaged".to_owned()))));
            }
            None => {
                let found = self.search(at + 1)?;
                let cut = found == self.length;
                let problem = if cut { "the last message is cut off or damaged" } else { "no message begins here" };
                (found, Piece::Lost(problem.to_owned()))
            }
        };
        self.at = end;
        Ok(Some((at..end, piece)))
    }

    /// The part of the recording whose content takes these bytes.
    pub(crate) fn chunk(&mut self, content: Range<u64>) -> io::Result<Result<Piece, String>> {
        let len = content.end.saturating_sub(content.start);
        if content.end > self.length {
            return Ok(Err("reaches beyond the end of the file".to_owned()));
        }
        self.message(content.start, MessageHeader { kind: MessageKind::ArrowMsg, len })
    }

    /// The list of all chunks, when the file was closed.
    pub(crate) fn manifests(&mut self) -> io::Result<Option<Vec<RawRrdManifest>>> {
        let Some(start) = self.length.checked_sub(FOOTER) else { return Ok(None) };
        let mut end = [0; FOOTER as usize];
        self.read_at(start, &mut end)?;
        let Some(footer) = footer(&end) else { return Ok(None) };
        let Some(entry) = footer.entries.first() else { return Ok(None) };
        let span = entry.rrd_footer_byte_span_from_start_excluding_header;
        // The footer's own list is the last thing before this pointer to it.
        if span.start.checked_add(span.len) != Some(start) {
            return Ok(None);
        }
        let mut list = vec![0; span.len as usize];
        self.read_at(span.start, &mut list)?;
        if StreamFooter::compute_crc(&list) != entry.crc_excluding_header {
            return Ok(None);
        }
        let manifests = quietly(|| {
            let list = re_protos::log_msg::v1alpha1::RrdFooter::from_rrd_bytes(&list).ok()?;
            list.manifests.iter().map(|manifest| manifest.to_application(()).ok()).collect()
        });
        Ok(manifests.unwrap_or(None))
    }

    fn read_at(&mut self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(at))?;
        self.file.read_exact(bytes)
    }

    /// The bytes of a header at this place.
    fn header_bytes(&mut self, at: u64) -> io::Result<Option<[u8; HEADER as usize]>> {
        let mut bytes = [0; HEADER as usize];
        if self.length.checked_sub(at).is_none_or(|left| left < HEADER) {
            return Ok(None);
        }
        self.read_at(at, &mut bytes)?;
        Ok(Some(bytes))
    }

    /// The header of a message at this place, if it can be one.
    fn header_at(&mut self, at: u64) -> io::Result<Option<MessageHeader>> {
        let Some(bytes) = self.header_bytes(at)? else { return Ok(None) };
        let Some(header) = header(&bytes, self.length - at - HEADER) else { return Ok(None) };
        if header.kind != MessageKind::End {
            return Ok(Some(header));
        }
        // The file's footer follows; old files have none. Anything else that looks like an end is a row of zeros.
        let left = self.length - at - HEADER - header.len;
        if left < FOOTER {
            return Ok((left == 0 && header.len == 0).then_some(header));
        }
        let mut bytes = [0; FOOTER as usize];
        self.read_at(at + HEADER + header.len, &mut bytes)?;
        Ok(footer(&bytes).map(|_| header))
    }

    /// Whether the list at the end of the file begins here and is cut off or damaged: no part of the run.
    fn is_broken_end(&mut self, at: u64) -> io::Result<bool> {
        let Some(bytes) = self.header_bytes(at)? else { return Ok(false) };
        let end = header(&bytes, u64::MAX).filter(|header| header.kind == MessageKind::End && header.len > 0);
        let end = end.and_then(|header| at.checked_add(HEADER + FOOTER)?.checked_add(header.len));
        Ok(end.is_some_and(|end| end >= self.length && end - at < MOST_LIST))
    }

    fn plausible(&mut self, at: u64) -> io::Result<bool> {
        Ok(at == self.length || self.header_at(at)?.is_some())
    }

    /// The first place from here on where a message begins that can be read; the end of the file when there is none.
    fn search(&mut self, from: u64) -> io::Result<u64> {
        let mut window = Vec::new();
        let mut start = from;
        while start + HEADER <= self.length {
            let len = WINDOW.min(self.length - start);
            window.resize(len as usize, 0);
            self.read_at(start, &mut window)?;
            for (i, bytes) in window.windows(HEADER as usize).enumerate() {
                // Kinds are small numbers; this is quick, and rules nearly every place out.
                if bytes[0] > 3 || bytes[1..8] != [0; 7] {
                    continue;
                }
                let at = start + i as u64;
                let Some(header) = header(bytes, self.length - at - HEADER) else { continue };
                let end = at + HEADER + header.len;
                let begins = match header.kind {
                    MessageKind::End => header.len > 0 && end + FOOTER == self.length && self.header_at(at)?.is_some(),
                    _ => header.len > 0 && self.plausible(end)? && self.message(at + HEADER, header)?.is_ok(),
                };
                if begins {
                    return Ok(at);
                }
            }
            // A header may lie across two windows.
            start += len - HEADER + 1;
        }
        Ok(self.length)
    }

    /// Reads the content of a message.
    fn message(&mut self, at: u64, header: MessageHeader) -> io::Result<Result<Piece, String>> {
        let mut content = vec![0; header.len as usize];
        self.read_at(at, &mut content)?;
        let (stream, injector) = (&self.header, &mut self.injector);
        // Arrow panics on a damaged schema.
        let piece = quietly(|| decode(content, header.kind, stream, injector));
        Ok(piece.unwrap_or_else(|()| Err("a message makes no sense".to_owned())))
    }
}

fn footer(bytes: &[u8]) -> Option<StreamFooter> {
    // It always has one entry; the decoder would ask for memory for as many as it says.
    if bytes.last_chunk() != Some(&1u32.to_le_bytes()) {
        return None;
    }
    quietly(|| StreamFooter::from_rrd_bytes(bytes).ok()).unwrap_or(None)
}

fn header(bytes: &[u8], left: u64) -> Option<MessageHeader> {
    MessageHeader::from_rrd_bytes(bytes).ok().filter(|header| header.len <= left)
}

fn decode(
    content: Vec<u8>,
    kind: MessageKind,
    stream: &StreamHeader,
    injector: &mut CachingApplicationIdInjector,
) -> Result<Piece, String> {
    let text = |error: &dyn std::fmt::Display| error.to_string();
    let (version, _) = stream.to_version_and_options().map_err(|error| text(&error))?;
    let length = content.len() as u64;
    let message = Msg::decode(content.into(), Default::default(), kind, injector, Some(version));
    let mut message = message.map_err(|error| text(&error))?.ok_or("an end where there is none")?;
    if let Msg::ArrowMsg(arrow) = &mut message {
        if Compression::from(arrow.compression()) != Compression::Off {
            // The decoder would believe this number and ask for as much memory.
            if arrow.uncompressed_size > length.saturating_mul(LZ4_EXPANSION) {
                return Err(format!("{length} bytes can't have been {}", arrow.uncompressed_size));
            }
            let mut plain = vec![0; arrow.uncompressed_size as usize];
            lz4_flex::block::decompress_into(&arrow.payload, &mut plain).map_err(|error| text(&error))?;
            arrow.payload = plain.into();
            arrow.set_compression(re_protos::common::v1alpha1::Compression::None);
        }
        check_lengths(&arrow.payload)?;
    }
    let message = message.to_application((injector, Some(version))).map_err(|error| text(&error))?;
    Ok(match &message {
        LogMsg::ArrowMsg(_, arrow) => {
            let chunk = Chunk::from_arrow_msg(arrow).map_err(|error| text(&error))?;
            check_names(&chunk)?;
            Piece::Chunk(Box::new(message), Box::new(chunk))
        }
        _ => Piece::Message(Box::new(message)),
    })
}

/// Rerun reads a damaged name and can't list it: of two archetypes for one component, or two types for one timeline, the
/// list at the end of a file has one, and a file with such a list is refused as a whole.
fn check_names(chunk: &Chunk) -> Result<(), String> {
    for described in chunk.components().component_descriptors() {
        if let Some(archetype) = described.archetype {
            let field =
                described.component.strip_prefix(archetype.short_name()).and_then(|rest| rest.strip_prefix(':'));
            field.ok_or_else(|| format!("{} is no component of {archetype}", described.component))?;
        }
    }
    for times in chunk.timelines().values() {
        let timeline = times.timeline();
        let right = match timeline.name().as_str() {
            TICK => TimeType::Sequence,
            TIME => TimeType::DurationNs,
            SENDER_CLOCK | RECORDER_CLOCK => TimeType::TimestampNs,
            _ => continue,
        };
        if timeline.typ() != right {
            return Err(format!("timeline {} is a {}, no {right}", timeline.name(), timeline.typ()));
        }
    }
    Ok(())
}

/// Arrow asks for as much memory as a message says that it takes: none may say more than there is.
fn check_lengths(stream: &[u8]) -> Result<(), String> {
    const CONTINUATION: [u8; 4] = [0xFF; 4];
    let mut rest = stream;
    let number = |bytes: &[u8]| bytes.first_chunk().copied().map(u32::from_le_bytes);
    while !rest.is_empty() {
        rest = rest.strip_prefix(&CONTINUATION).unwrap_or(rest);
        let Some(length) = number(rest) else { return Err("cut off".to_owned()) };
        rest = &rest[4..];
        if length == 0 {
            return Ok(());
        }
        let header = rest.get(..length as usize).ok_or("longer than its message")?;
        let message = root_as_message(header).map_err(|error| error.to_string())?;
        let body = usize::try_from(message.bodyLength()).map_err(|error| error.to_string())?;
        rest = rest[header.len()..].get(body..).ok_or("longer than its message")?;
    }
    Ok(())
}

/// Calls what may panic on damaged data, without a word on standard error.
pub(crate) fn quietly<T>(call: impl FnOnce() -> T) -> Result<T, ()> {
    thread_local! {
        static QUIET: Cell<bool> = const { Cell::new(false) };
    }
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !QUIET.get() {
                usual(panic);
            }
        }));
    });
    QUIET.set(true);
    let done = catch_unwind(AssertUnwindSafe(call));
    QUIET.set(false);
    done.map_err(drop)
}
